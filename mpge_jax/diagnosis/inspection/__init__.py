"""What a log holds before anything is diagnosed: what matched, what looks wrong, a picture, and a map to start from."""
