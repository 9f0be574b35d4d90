"""Campaigns: measurements and what is known of them, in TOML and CSV.

Others take: a campaign with all that its files say, checked (`campaign`), its parameters and what
turns the scale into a light yield (`parameter`), readings (`measurements`), what became of raw data
step by step (`reduction`), what a file may hold and its JSON schema (`entries`), the text of a
campaign that goes on from another, or a raw one in plain numbers (`editor`).
"""
