"""The shared physics and the estimator."""
