"""How far windows speak for a hypothesis: paired gains, held-out errors, and what noise alone would leave."""
