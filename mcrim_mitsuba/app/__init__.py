"""The page: a campaign in a browser, its model moved by hand.

`page` makes the application of a `session`, `access` serves it to the person who started it and
to nobody else. A session has its `jobs`, a history of its `state`, and the model of the readings in
the table, which is a `live_model`; `layout`, `bench_picture` and `exchange` show it and
bring it in and out.
"""
