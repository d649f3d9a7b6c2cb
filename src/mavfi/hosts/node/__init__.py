"""Attaches to any ROS 1 application while it runs: looks at its graph, changes its messages, watches its numbers.

Everything speaks ROS's own protocols (XML-RPC with master and nodes, TCPROS for messages), so ROS need not be installed
where mavfi runs, and the target needs neither a restart nor a hook.  All listening is on loopback.
"""
