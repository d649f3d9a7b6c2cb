"""A campaign is flown as the command line and the Python API do it."""

from mavfi.campaign import run
from mavfi.campaign.begin import begin


def run_campaign(campaign, directory, *, models_dir=None, extend=False, **options):
    """Resolve a campaign, and fly its missing runs."""
    begun = begin(campaign, directory, models_dir=models_dir, extend=extend)
    return run.run_campaign(begun, directory, extend=extend, **options)
