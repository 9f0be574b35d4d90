"""From a laboratory's raw data to a campaign's readings and priors, a step a module."""
