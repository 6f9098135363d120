M

State size:
900000000

Marker states:
0

Vocal states:


Transitions:

