"""Campaigns: one scene flown many times with dispersed numbers, and what the runs have in common.

`read` makes a campaign from a file, `engine` runs it block by block, here or on a cluster, `store` keeps the rows,
and `summary` and `report/campaign_page.py` say what they show. A run depends, to the bit, on the campaign and its own
number alone, not on block, worker or order.
"""
