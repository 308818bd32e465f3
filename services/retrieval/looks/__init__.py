"""What single looks say: features and texture of maps, change against the place's past, what was screened out."""
