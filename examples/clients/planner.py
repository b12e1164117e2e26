"""Plan with a UDP socket only: request a motion too early, and print the refusal: planner.py [PORT]."""

import socket
import sys

PORT = int(sys.argv[1]) if len(sys.argv) > 1 else 8057

with socket.socket(type=socket.SOCK_DGRAM) as link:
    link.settimeout(5.0)
    link.connect(("127.0.0.1", PORT))
    for number, command in enumerate(("session_reinitxx", "execute_motionxx"), start=1):
        link.send(f"{command}_#{number};".encode())
        print(f"{command}: {link.recv(2048).decode()}")
