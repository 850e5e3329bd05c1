"""How fast this is: simulation, grounding and SAC; beside other libraries; by size; on a GPU."""
