"""Commands: `sweep`, `diagnose`, `pretrain`, `benchmark`. The library never imports from here."""
