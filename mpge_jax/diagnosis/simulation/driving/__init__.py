"""What drives the machine in a recording: commands, measured forces, and what actuators hold."""
