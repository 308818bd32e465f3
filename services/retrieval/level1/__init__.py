"""CYGNSS level-1 files: reader, writer, screening over land, reflectivity."""
