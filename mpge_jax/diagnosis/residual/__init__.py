"""A model of what no known effect explains."""
