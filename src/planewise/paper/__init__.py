"""The paper's objective: its terms for every reading, its search and ours."""
