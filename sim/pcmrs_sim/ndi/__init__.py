"""A virtual NDI tracker: the protocol of a Polaris on a network or serial link, in front of the simulated tracker."""
