"""The paper's study: its claims and figures beside ours, redundant processors, failure rates, `mavfi reproduce`."""
