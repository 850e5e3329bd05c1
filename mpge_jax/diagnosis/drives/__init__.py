"""The side between commands and measured forces."""
