"""Windows of recordings, and machines with effects simulated along them."""
