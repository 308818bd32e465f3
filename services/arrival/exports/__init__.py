"""An arrival map in the forms that others read: netCDF, GeoTIFF, GeoJSON, KML, WRF-SFIRE, wrfxweb, ONNX."""
