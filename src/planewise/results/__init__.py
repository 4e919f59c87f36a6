"""What is written of planes that were found."""
