"""How close a picture is to its reference. Pictures are (H, W, 3) float32 linear radiance."""
