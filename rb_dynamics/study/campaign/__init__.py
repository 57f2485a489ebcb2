"""Campaigns: one scene run many times with dispersed numbers, and statistics over the runs.

`read` makes a campaign from a file, `engine` runs it block by block, here or on a cluster, `store` keeps the rows, and
`summary` and `report/campaign_page.py` evaluate them. A run depends, to the bit, only on the campaign and its own
number, not on block, worker or order.
"""
