"""A result for people: files, sentences, pages and pictures."""
