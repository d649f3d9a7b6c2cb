"""Campaigns on a foreign ROS node: the same ledger, pool and reports, with trials instead of flights.

A trial starts the node in a private network, drives it, flips a bit in one of its registers, and compares its output
with the golden one.
"""
