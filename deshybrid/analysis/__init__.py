"""What can be known of a stochastic model before anything is measured: the parts of the command `analyse`."""
