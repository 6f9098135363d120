"""deshybrid: a discrete-event and automaton toolkit with a hybrid-observer compiler."""
