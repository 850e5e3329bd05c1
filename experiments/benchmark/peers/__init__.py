"""This library beside others that do the same work: each ratio from one run, ours and the peer's in turn."""
