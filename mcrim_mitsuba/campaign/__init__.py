"""Campaigns: measurements and what is known of them, in TOML and CSV.

Others take: a campaign with all that its files say, checked (`campaign`), its parameters and what
turns the scale into a light yield (`parameter`), readings (`measurements`), what raw data became of
every step (`raw_data`), what a file may hold and its JSON schema (`entries`), the text of a
campaign that goes on from another (`editor`), a raw campaign in plain numbers (`plain`).
`reduction` turns raw data into numbers when a campaign is read.
"""
