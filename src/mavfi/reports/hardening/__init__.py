"""The hardening advice and its certificate: text, tables and a page."""
