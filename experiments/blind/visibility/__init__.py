"""Whether recordings can show what is hidden: its size, its windows, and what cannot be told from it."""
