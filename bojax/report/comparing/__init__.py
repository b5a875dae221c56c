"""One page over several results folders and curves of other libraries."""
