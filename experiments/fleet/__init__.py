"""Many robots of one model: a diagnosis each, what all share, what is one robot's own, and what changed since."""
