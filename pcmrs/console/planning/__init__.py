"""Planning in the page: what is placed on the body's surface, looked at by the daemon, and sent when it is right.

Imports nothing: processes that read files load a part of it only.
"""
