"""Scene files as text: read, judged by reading, edited; and those that ship with the package."""
