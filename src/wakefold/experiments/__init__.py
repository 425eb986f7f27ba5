"""The experiments of the papers, a folder for each with the code that only it uses; what `reproduce` runs."""
