"""Measurements and what is known of them: TOML and CSV, raw data reduced to readings."""
