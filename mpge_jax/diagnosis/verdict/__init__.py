"""The judgement: what is named, what is left, and where."""
