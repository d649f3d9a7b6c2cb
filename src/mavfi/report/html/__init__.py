"""Self-contained HTML pages of flights, campaigns and studies, which open from `file://` without a network."""
