"""What every room stands on: refusals with their mend, numbers as people type them, files."""
