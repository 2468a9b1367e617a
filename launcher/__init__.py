"""What mobo.py is made of; standard library only."""
