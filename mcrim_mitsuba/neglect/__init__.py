"""What a campaign's model leaves out, put in piece by piece: what it does to every result."""
