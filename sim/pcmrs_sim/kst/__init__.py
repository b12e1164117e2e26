"""A virtual cabinet that speaks as the KST 1.7 server of a KUKA iiwa does, on the simulated arm.

Written from the public sources of the server (KUKA Sunrise Toolbox 1.7, its Java application for the cabinet); not
compared with a real cabinet.
"""
