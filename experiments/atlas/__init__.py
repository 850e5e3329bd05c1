"""The public machines of the recordings folder, each diagnosed, on one page."""
