"""Areas in the plane: polygons with holes, their files, distances to their borders, and ways in them."""
