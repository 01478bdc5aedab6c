"""Checks that are counted, for scripts that speak MAVLink with our programs."""

import socket
import sys


class Checks:
    """Ends the script at the first check that fails, in the name of `subject`."""

    def __init__(self, subject):
        self.subject = subject
        self.count = 0

    def __call__(self, condition, what):
        if not condition:
            sys.exit(f"{self.subject}: {what}")
        self.count += 1


def free_port():
    """Of UDP; given back just before somebody takes it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]
