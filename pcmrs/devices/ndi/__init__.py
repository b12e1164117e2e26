"""The host side of an NDI Polaris or Vega: a reader in a process of its own, and what its frames mean."""
