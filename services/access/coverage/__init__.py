"""What specular points cover: point targets and the cells of grids."""
