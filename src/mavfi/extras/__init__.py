"""What stands beside the core: one folder per extra, each plugged in through entry points alone."""
