"""Work for a night: many tables of eta, many campaigns, gone on with after an interruption."""
