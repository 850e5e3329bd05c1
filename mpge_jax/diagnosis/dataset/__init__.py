"""From a model and recordings to what a search works on."""
