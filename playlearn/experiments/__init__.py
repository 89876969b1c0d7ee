"""What is compared, and the small experiments of a lecture."""
