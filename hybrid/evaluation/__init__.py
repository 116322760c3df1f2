"""Quality and speed of hybrid frames against baselines, at equal rays and at equal time."""
