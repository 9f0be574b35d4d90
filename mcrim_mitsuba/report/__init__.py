"""The report of a campaign as one page: what it tells (story), its pictures, and the page."""
