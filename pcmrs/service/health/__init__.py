"""Health of the daemon, its metrics, and its status for the service manager."""
