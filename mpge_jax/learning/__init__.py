"""Learners and their parts: networks, TRPO, PPO, SAC, value functions, and an agent trained with them."""
