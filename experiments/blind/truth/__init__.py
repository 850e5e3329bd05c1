"""The true machine: what hidden physics adds, how it is driven, simulated finely and recorded."""
