"""A demonstration of both halves: an arm with something concealed, and a public machine's log, on one page."""
