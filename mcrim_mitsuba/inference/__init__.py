"""From readings to answers: likelihood, fit, compare, diagnose, repair, budget, plan."""
