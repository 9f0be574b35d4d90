"""Pictures of fits, diagnoses, repairs and light, each with its numbers as CSV beside it."""
