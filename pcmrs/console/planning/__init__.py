"""Planning in the page: plans on the body's surface, checked by the daemon, and sent when they are right.

This file imports nothing, so that processes that read files load only their part.
"""
