"""What many diagnoses and cells cost: measured, kept in docs/results/scale, and written as docs/scale.md."""
