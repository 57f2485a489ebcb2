"""Campaigns: one scene flown many times with dispersed numbers, and what the runs have in common.

`read` makes a campaign of a file, `engine` runs it block by block, here or on a cluster, `store` keeps the rows,
`summary` and `page` say what they show. A run depends on the campaign and its own number alone: not on the block,
the worker or the order, to the bit.
"""
