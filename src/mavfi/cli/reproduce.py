def reproduce() -> None:
    ''
