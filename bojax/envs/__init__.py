"""What is learned on: environments with declared bounds, written for one lane."""
