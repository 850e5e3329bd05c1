"""What rows hold that is no motion of the machine: empty and repeated ones, times that are not theirs, strays."""
