M

State size:
1

Marker states:
0

Vocal states:


Transitions:
0 1 1
