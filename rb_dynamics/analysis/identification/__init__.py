"""Identification: mass properties and more from recordings, with standard errors, and what they cannot determine."""
