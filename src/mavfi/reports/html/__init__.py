"""Self-contained HTML pages: one flight, and the report of a campaign.  They open from `file://` without a network."""
