"""What figures and films share: the protocol of a figure, curves, maps, and the outline of a domain."""
