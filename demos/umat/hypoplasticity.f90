! Hypoplasticity of sand with intergranular strain.
!   P.-A. von Wolffersdorff (1996), A hypoplastic relation for granular materials with a predefined
!     limit state surface, Mech. Cohes.-Frict. Mater. 1, 251-271;
!   A. Niemunis & I. Herle (1997), Hypoplastic model for cohesionless soils with elastic strain
!     range, Mech. Cohes.-Frict. Mater. 2, 279-299.
! The rates are integrated by the pair of Bogacki and Shampine, of orders 3 and 2, with substeps
! chosen by the error. DDSDDE is by differences over the same substeps.
!
! PROPS   1 phi_c (degrees)   2 h_s (Pa)   3 n   4 e_d0   5 e_c0   6 e_i0   7 alpha   8 beta
!         9 R (0: without intergranular strain)  10 m_R  11 m_T  12 beta_r  13 chi
!        14 pressure that is added to the stress (Pa), against stresses near zero
!        15 largest relative error of a substep
! STATEV  1-6 intergranular strain, tensor components 11, 22, 33, 12, 13, 23   7 void ratio
subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, &
    dstran, time, dtime, temp, dtemp, predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, &
    nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, layer, kspt, jstep, kinc)
  implicit none
  integer :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, jstep(4), kinc
  real(8) :: stress(ntens), statev(nstatv), ddsdde(ntens, ntens), sse, spd, scd, rpl
  real(8) :: ddsddt(ntens), drplde(ntens), drpldt, stran(ntens), dstran(ntens), time(2), dtime
  real(8) :: temp, dtemp, predef(1), dpred(1), props(nprops), coords(3), drot(3, 3), pnewdt
  real(8) :: celent, dfgrd0(3, 3), dfgrd1(3, 3)
  character(80) :: cmname
  integer, parameter :: most = 2000
  real(8), parameter :: degree = acos(-1d0)/180
  ! a symmetric tensor has six numbers; shear counts twice in products
  real(8), parameter :: twice(6) = [1d0, 1d0, 1d0, 2d0, 2d0, 2d0]
  real(8), parameter :: one(6) = [1d0, 1d0, 1d0, 0d0, 0d0, 0d0]
  real(8) :: start(13), ending(13), moved(13), D(6), step(most), h(6), theta, sine, a, sum0
  integer :: j, steps
  logical :: good

  sine = sin(degree*props(1))
  a = sqrt(3d0)*(3 - sine)/(2*sqrt(2d0)*sine)
  sum0 = 3 + a*a - a*sqrt(3d0)*((props(6) - props(4))/(props(5) - props(4)))**props(7)

  start = 0
  start(1:ntens) = stress
  start(1:3) = start(1:3) - props(14)
  call rotsig(statev, drot, h, 1, 3, 3)
  start(7:12) = h
  start(13) = statev(7)
  D = 0
  D(1:3) = dstran(1:3)
  D(4:ntens) = dstran(4:ntens)/2

  call integrate(start, D, ending, good)
  if (.not. good) then
    pnewdt = 0.25d0
    return
  end if
  theta = 1d-5*max(sqrt(sum(twice*D*D)), 1d-9)
  do j = 1, ntens
    h = D
    h(j) = h(j) + theta/twice(j)
    call repeat_steps(start, h, moved)
    ddsdde(:, j) = (moved(1:ntens) - ending(1:ntens))/theta
  end do
  stress = ending(1:ntens)
  stress(1:3) = stress(1:3) + props(14)
  statev(1:6) = ending(7:12)
  statev(7) = ending(13)

contains

  ! Changes of stress, intergranular strain and void ratio for a strain increment D
  function rate(y, D) result(dy)
    real(8), intent(in) :: y(13), D(6)
    real(8) :: dy(13), T(6), S(6), dev(6), trace, TT, tan_psi, cos3, F, e, ratio, ei, ec, ed
    real(8) :: fs, fd, N(6), LD(6), Lh(6), g(6), size, rho, along, weight, cube, devdev
    T = y(1:6)
    e = y(13)
    trace = sum(T(1:3))
    S = T/trace
    dev = S - one/3
    TT = sum(twice*S*S)
    devdev = sum(twice*dev*dev)
    tan_psi = sqrt(3*devdev)
    cos3 = 1
    if (devdev > 1d-24) then
      cube = dev(1)**3 + dev(2)**3 + dev(3)**3 + 6*dev(4)*dev(5)*dev(6) &
        + 3*dev(1)*(dev(4)**2 + dev(5)**2) + 3*dev(2)*(dev(4)**2 + dev(6)**2) &
        + 3*dev(3)*(dev(5)**2 + dev(6)**2)
      cos3 = max(-1d0, min(1d0, -sqrt(6d0)*cube/devdev**1.5d0))
    end if
    F = sqrt(tan_psi**2/8 + (2 - tan_psi**2)/(2 + sqrt(2d0)*tan_psi*cos3)) &
      - tan_psi/(2*sqrt(2d0))
    ratio = exp(-(-trace/props(2))**props(3))
    ed = props(4)*ratio
    ec = props(5)*ratio
    ei = props(6)*ratio
    fd = (max(e - ed, 0d0)/(ec - ed))**props(7)
    fs = props(2)/props(3)*(ei/e)**props(8)*(1 + ei)/ei*(-trace/props(2))**(1 - props(3))/sum0
    N = fs*fd*F*a/TT*(S + dev)
    LD = fs/TT*(F*F*D + a*a*S*sum(twice*S*D))
    dy = 0
    if (props(9) <= 0) then
      dy(1:6) = LD + N*sqrt(sum(twice*D*D))
    else
      size = sqrt(sum(twice*y(7:12)**2))
      g = 0
      if (size > 0) g = y(7:12)/size
      rho = min(size/props(9), 1d0)
      weight = rho**props(13)
      along = sum(twice*g*D)
      Lh = fs/TT*(F*F*g + a*a*S*sum(twice*S*g))
      dy(1:6) = (weight*props(11) + (1 - weight)*props(10))*LD
      dy(7:12) = D
      if (along > 0) then
        dy(1:6) = dy(1:6) + weight*(1 - props(11))*Lh*along + weight*N*along
        dy(7:12) = D - g*along*rho**props(12)
      else
        dy(1:6) = dy(1:6) + weight*(props(10) - props(11))*Lh*along
      end if
    end if
    dy(13) = (1 + e)*sum(D(1:3))
  end function

  ! A substep of the share s: the end by order 3, and its difference from order 2
  subroutine advance(y, D, s, z, error)
    real(8), intent(in) :: y(13), D(6), s
    real(8), intent(out) :: z(13), error(13)
    real(8) :: k1(13), k2(13), k3(13)
    k1 = rate(y, D)
    k2 = rate(y + s*k1/2, D)
    k3 = rate(y + s*3*k2/4, D)
    z = y + s*(2*k1 + 3*k2 + 4*k3)/9
    error = s*(-5*k1/72 + k2/12 + k3/9 - rate(z, D)/8)
  end subroutine

  subroutine integrate(y0, D, y, good)
    real(8), intent(in) :: y0(13), D(6)
    real(8), intent(out) :: y(13)
    logical, intent(out) :: good
    real(8) :: done, s, z(13), error(13), worst, scale
    integer :: tries
    y = y0
    done = 0
    s = 1
    steps = 0
    good = .false.
    do tries = 1, 4*most
      call advance(y, D, s, z, error)
      scale = max(sqrt(sum(twice*z(1:6)**2)), 1d-3)
      worst = sqrt(sum(twice*error(1:6)**2))/scale
      if (props(9) > 0) worst = max(worst, sqrt(sum(twice*error(7:12)**2))/props(9))
      if (.not. (sum(z(1:3)) < 0 .and. worst < huge(1d0))) then
        s = s/4
        if (s < 1d-9) return
        cycle
      end if
      if (worst <= props(15)) then
        if (steps == most) return
        steps = steps + 1
        step(steps) = s
        y = z
        done = done + s
      end if
      if (done >= 1 - 1d-12) exit
      s = s*max(0.2d0, min(4d0, 0.9d0*(props(15)/max(worst, 1d-30))**(1d0/3)))
      s = min(s, 1 - done)
    end do
    good = done >= 1 - 1d-12
  end subroutine

  subroutine repeat_steps(y0, D, y)
    real(8), intent(in) :: y0(13), D(6)
    real(8), intent(out) :: y(13)
    real(8) :: z(13), error(13)
    integer :: i
    y = y0
    do i = 1, steps
      call advance(y, D, step(i), z, error)
      y = z
    end do
  end subroutine

end subroutine
