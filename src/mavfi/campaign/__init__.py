"""Campaigns: thousands of paired flights, planned before the first one, recorded in a ledger, judged afterwards."""
