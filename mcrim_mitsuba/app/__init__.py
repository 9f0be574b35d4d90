"""The page: a campaign in a browser, its model moved by hand.

`page` makes the application of a `session`, `access` serves it to the person who started it and
to nobody else. `state`, `layout`, `charts` and `exchange` are parts of these.
"""
