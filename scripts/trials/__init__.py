"""Trials of what the package says of itself: is it right, and are its errors honest?

    python scripts/trials closure    # does the fit know its own errors? synthetic campaigns
    python scripts/trials hidden     # does a diagnosis find what is missing?
    python scripts/trials peak       # are the centroids of histograms right?
    python scripts/trials kill       # does a job survive kill -9?

Interrupted, the same line goes on, as long as the code is the same; a kill begins anew.
"""
