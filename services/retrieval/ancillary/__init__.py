"""What other sensors and maps know about the places of looks: rasters of any CRS, SMAP, burned-area products."""
