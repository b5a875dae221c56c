"""A campaign against bojax: bad input, kills, damaged folders, full disks and extreme numbers, from a seed."""
