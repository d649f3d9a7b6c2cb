"""Attaches to any running ROS 1 application: surveys its graph, modifies its messages, monitors its numeric fields.

All communication uses ROS's own protocols (XML-RPC with master and nodes, TCPROS for messages): ROS need not be
installed where mavfi runs, and the target needs neither a restart nor instrumentation.  All sockets listen on loopback.
"""
