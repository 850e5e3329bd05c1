"""The machine as MuJoCo has it: its model, names, joint space and contacts."""
