"""Host side of an NDI Polaris or Vega: a reader in its own process, and the conversion of its frames into poses."""
