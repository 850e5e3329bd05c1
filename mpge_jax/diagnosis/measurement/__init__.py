"""What recording does to the machine's motion and forces: delays, zeros, and the age of forces."""
