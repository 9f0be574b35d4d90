"""The command: ``main`` and a thin module per verb, which read what was typed and call the public API.

`options` and `terminal` are what verbs share in reading and showing, `showing` what those of
campaigns do alike; `lab` is ``mcrim lab``. `trials` and `campaign_jobs` serve scripts.
"""
