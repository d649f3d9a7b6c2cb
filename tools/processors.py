"""Tables of figures that depend on the processor: a page keeps those that were measured on others."""

import re

from mavfi.campaign.fingerprint import processor


def with_others(table: str, page: str, name: str) -> str:
    """A table of this processor, then those of others.

    Args:
        table: What was measured; no line begins with `**`.
        page: The page with earlier ones between `<!-- name:begin -->` and `<!-- name:end -->`, or none.
        name: Name of the markers.
    """
    heading = f"**{processor()}**"
    earlier = page.partition(f"<!-- {name}:begin -->")[2].partition(f"<!-- {name}:end -->")[0]
    tables = [f"{heading}\n\n{table}"]
    for part in re.split(r"(?m)^(?=\*\*)", earlier):
        other = part.strip()
        if other and not other.startswith(heading):
            tables.append(other)
    return "\n\n".join(tables)
