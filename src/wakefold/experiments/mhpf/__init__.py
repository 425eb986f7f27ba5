"""The experiments of Hawasly et al. (2016, 2017), one file for each figure."""
