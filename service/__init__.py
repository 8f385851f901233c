"""Who asks, what is kept, what is answered?"""
