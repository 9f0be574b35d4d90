"""A picture of a bench: what its parts are, where they stand and how they are labelled."""
