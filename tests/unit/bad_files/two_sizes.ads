M

State size:
1 2

Marker states:
0

Vocal states:


Transitions:

