"""Python files with a task for a machine: what is known of it, and the text that runs as it is."""
