"""Curves as other libraries write them: Stable-Baselines3, Weights & Biases, TensorBoard, rliable."""
