"""The next 24 hours: rate of spread from the arrival field, weather where it is given, and fast marching."""
