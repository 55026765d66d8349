"""Unity Addressables' remote catalogues, written and read without Unity: JSON and the three binary forms."""
