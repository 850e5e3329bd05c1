"""The search for effects: forward, backward, and against its alternatives."""
