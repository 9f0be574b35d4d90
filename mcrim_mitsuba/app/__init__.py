"""The page: a campaign in a browser, its model moved by hand.

`page` makes the application of a `session`, `access` serves it to the person who started it and
to nobody else. A session has a `simulated_bench` and its `jobs`; `state`, `layout`, `bench_picture`
and `exchange` are parts of these.
"""
