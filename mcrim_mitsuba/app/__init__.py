"""The interactive page: `session` holds what it works on, `page` shows it, `gate` guards it."""
