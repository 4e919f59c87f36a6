"""What belongs to the whole process: memory, threads, warnings; and the time of each stage."""
