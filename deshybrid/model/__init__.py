"""The model language: source text, expressions, schema, elaboration to a HybridSystem, and its abstraction to a DES."""
