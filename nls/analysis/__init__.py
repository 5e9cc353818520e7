"""Numbers about a graph at some values, without sentences: one question a file."""
