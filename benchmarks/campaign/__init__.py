"""A campaign against bojax, from a seed: bad input, kills, damaged folders, full disks, extreme numbers."""
