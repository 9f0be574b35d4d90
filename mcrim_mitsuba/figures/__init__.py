"""Pictures of a comparison, a diagnosis and a repair, each with its numbers as CSV beside it."""
