"""The command: a thin module per verb, which reads what was typed and calls the public API.

`options` and `terminal` are what verbs share in reading and showing, `showing` what those of
campaigns do alike; `lab` is ``mcrim lab``.
"""
